"""Records what is published: MCAP files, and a ring of the last seconds that triggers turn into clips."""
