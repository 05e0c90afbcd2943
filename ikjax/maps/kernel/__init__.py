"""The compiled loop of a sweep: goals made, solved and reduced without leaving the processor's caches."""
