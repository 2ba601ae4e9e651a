"""Torture: commands killed and files damaged at random, and what comes of it.

A small project is made once by the commands themselves. Each try copies it, does one thing to it,
and compares what commands then give with what they give undisturbed.
"""
