"""Which family an arm belongs to: facts about its axes, one rule for each family; the first that fits."""
