"""What can be wrong with a hand's files, by kind of fault. The door is
``fungrasp.hands.checking.hand_checks``."""
