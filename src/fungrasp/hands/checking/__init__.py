"""Checks of a hand's files, by kind of fault; ``hand_checks.check_hand_files`` runs them all."""
