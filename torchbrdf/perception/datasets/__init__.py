"""Readers of what people answered in published studies, and of what they were asked about."""
