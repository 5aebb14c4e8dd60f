"""How fast physics is stepped."""
