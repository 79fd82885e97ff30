"""Sections that every run with a trained policy can have, made from its folder alone.

Each takes the `Folder` of a run. Where the part that gives its numbers failed, or was not asked
for, the section says so in a sentence.
"""
