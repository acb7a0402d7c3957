"""Recipes: studies as short plain Python files, one a file, run by name."""
