"""ARCOS, the protocol of Pioneer bases: framing, packets, session, setpoints."""
