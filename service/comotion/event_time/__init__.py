"""Event time: puts the batches of many sources in time order."""
