"""What torchbrdf brings along: a mesh, an environment, fitted materials."""
