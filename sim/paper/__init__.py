"""The paper's experiments: tasks, agents, a grid of runs, and the tables made of it."""
