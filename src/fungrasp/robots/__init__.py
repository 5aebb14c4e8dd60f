"""Robots: interface to arms, hands and object trackers; drivers, wire codecs, emulators, the twin."""
