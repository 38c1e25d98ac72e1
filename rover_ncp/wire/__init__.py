"""What goes over the wire: topics, messages, the lease protocol, settings of Zenoh."""
