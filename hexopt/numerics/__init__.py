"""Numerical building blocks: batched, checked, ignorant of robots."""
