"""A scene in Foxglove's own messages, live or in a file. Needs the extra `foxglove`."""
