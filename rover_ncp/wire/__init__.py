"""The wire: topics, messages, the lease protocol, settings of Zenoh."""
