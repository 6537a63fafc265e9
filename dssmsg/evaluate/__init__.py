"""Quality: scorers against the simulator's truth and their tables. Time is measured in benchmarks/."""
