"""Writes and reads recordings: MCAP files, clips of the last seconds, and the recordings of others, played again."""
