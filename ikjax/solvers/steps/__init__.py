"""Steps that several families share: a shoulder, a two-link triangle, a wrist, lines in space."""
