"""All compiled code of the method, functions of arrays. Each kernel has a readable twin among the tests."""
