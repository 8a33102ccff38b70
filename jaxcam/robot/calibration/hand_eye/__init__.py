"""Hand and eye: where a camera stands, from a tag on the hand and the grip's poses."""
