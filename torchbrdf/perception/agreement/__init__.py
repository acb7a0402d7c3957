"""How well a distance agrees with people: statistics, scores, tables."""
