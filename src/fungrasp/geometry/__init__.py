"""Poses, batched rigid transforms, signed distance of a mesh. Knows nothing of hands or physics."""
