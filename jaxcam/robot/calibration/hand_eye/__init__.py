"""Hand and eye: where a camera is, from a tag or board and the grip's poses, by either mount."""
