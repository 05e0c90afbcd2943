"""Numbers, rigid bodies, small linear algebra, tolerances, and what XLA needs to be told. Knows no robot."""
