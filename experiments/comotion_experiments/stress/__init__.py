"""Stress: scenes that are not clean, and how soon the methods get over it."""
