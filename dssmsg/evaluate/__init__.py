"""Quality: scorers against the simulator's truth, and the tables made of them. Time is measured in benchmarks/."""
