"""The stack simulation: firmware, bridge and driver on a virtual clock."""
