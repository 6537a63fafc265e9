"""The simulator: world, robot, scenes, furniture, camera."""
