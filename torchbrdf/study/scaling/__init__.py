"""Scales from paired comparisons."""
