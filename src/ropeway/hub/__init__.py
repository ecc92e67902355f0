"""Lets several users of one graph hear each other: views, who owns a name, active and standby publishers."""
