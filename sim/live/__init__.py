"""Mock, bridge and driver as real processes on this machine."""
