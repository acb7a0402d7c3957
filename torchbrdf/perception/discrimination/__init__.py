"""What a distance means: the share of observers who would be expected to tell two things apart."""
