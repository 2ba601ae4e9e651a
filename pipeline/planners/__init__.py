"""Planners: whatever turns scenarios into plans, and the names they go by."""
