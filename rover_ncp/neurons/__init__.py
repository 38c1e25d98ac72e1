"""What the neurons of a policy do: currents, phases of a manoeuvre, findings, and how a circuit is drawn."""
