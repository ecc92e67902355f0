"""Files of recordings: whole, cut short, and odd."""
