"""Sets of positions and of orientations, each member a function of whole numbers."""
