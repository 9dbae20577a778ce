"""The commands of ``comotion``, by what they do.

A module imports nothing heavy at its top (typer, options and errors only), so that ``comotion
--help`` stays fast; it offers a class a command, or a :class:`typer.Typer` for a group of commands, that
:mod:`comotion_deploy.cli` registers by name.
"""
