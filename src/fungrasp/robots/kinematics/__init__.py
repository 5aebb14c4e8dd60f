"""From poses of the palm to joints of an arm."""
