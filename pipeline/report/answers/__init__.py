"""Sentences that the numbers write."""
