"""A model of the link that a connection uses: its pace, its round trip, and how much may be on the way."""
