"""Numbers, rigid bodies, small linear algebra, tolerances, and workarounds for XLA. Knows no robot."""
