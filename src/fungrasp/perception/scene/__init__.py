"""The table, the world frame, and which pixels belong to what."""
