"""The accuracy report: the default method and the thesis method on scenes and recordings."""
