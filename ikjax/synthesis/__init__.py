"""Change an arm, or where it stands, for its goals: dimensional synthesis and base placement."""
