"""What lights a scene: environments and punctual lights."""
