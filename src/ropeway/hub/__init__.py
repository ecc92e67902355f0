"""Lets several users of one graph hear each other: views, ownership of names, active and standby publishers."""
