"""Trials averaged: what tables, figures and sentences are made from."""
