"""Which family an arm belongs to: facts about its axes, one rule a family, the first rule whose facts
hold."""
