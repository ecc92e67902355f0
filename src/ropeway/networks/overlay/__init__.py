"""The global overlay: names without place, identity, sealing; the data plane is Eclipse Zenoh."""
