"""Planners: whatever turns scenarios into plans, one file each, and the names they go by."""
