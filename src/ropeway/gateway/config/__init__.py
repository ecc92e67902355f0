"""The configuration of a gateway as data: the model, its checks and its JSON schema. Nothing here runs."""
