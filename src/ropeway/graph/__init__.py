"""The contract of all networks: ``Graph`` and its parts, samples, events, calls, actions and what networks share."""
