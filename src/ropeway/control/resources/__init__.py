"""The resources of the control API, one file per subject; each has its table as ``resources``."""
