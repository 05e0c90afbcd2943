"""Steps that several families share: shoulder, triangle, wrist, first three joints, axes in space."""
