"""What somebody else adds to torchbrdf: one thing of each kind."""
