"""rosbridge networks: the protocol, the link between two peers, the client that dials and the server that listens."""
