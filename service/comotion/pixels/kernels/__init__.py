"""Arrays in, arrays out: all compiled code of the method. Each kernel has a readable twin among the tests."""
