"""The mission: survey -> revisit -> seek, frame by frame through the plug-ins."""
