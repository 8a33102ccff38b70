"""The viewer: robots, cameras, rays and pictures of any source in a browser."""
