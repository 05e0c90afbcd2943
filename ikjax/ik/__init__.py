"""What one does with an arm and goals: solve, choose, project, track, differentiate, verify."""
