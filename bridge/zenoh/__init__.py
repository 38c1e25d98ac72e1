"""Zenoh at the bridge: sessions, configuration, certificates."""
