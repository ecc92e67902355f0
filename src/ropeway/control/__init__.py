"""The control plane: shows, explains and changes a running gateway over HTTP, on a UNIX socket of its user."""
