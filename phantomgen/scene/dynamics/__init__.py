"""Time of a scene: signals, objects that move, materials that change."""
