"""The neural circuit: wiring, solver, mappings and policy files. No robot, simulator or network."""
