"""One goal in, every branch out, in scalars: families built on shared steps, measured by one pipeline."""
