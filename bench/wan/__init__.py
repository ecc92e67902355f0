"""Two networks joined by a link with delay, jitter, loss and a rate: what arrives of cameras and a command, when."""
