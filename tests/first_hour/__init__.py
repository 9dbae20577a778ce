"""A newcomer's first hour: what is said to wrong inputs, and a clean installation step by step."""
