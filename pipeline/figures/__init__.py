"""Figures and tables: numbers, names, intervals and styles, whatever they show."""
