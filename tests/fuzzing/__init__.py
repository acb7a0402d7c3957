"""Readers under fuzz: changed files, and what came of them. `python -m tests.fuzzing --help` runs the long form."""
