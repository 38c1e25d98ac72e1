"""The neural circuit: wiring, solver, mappings and policy files. Knows no robot, simulator or network."""
