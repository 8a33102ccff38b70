"""Success over what evaluations vary beside the pairs: errors of poses, and fields of view."""
