"""How fast physics is stepped; recorded episodes in other engines."""
