"""Recorders of a running gateway: what crossed, how the links were, all the time or around what happened."""
