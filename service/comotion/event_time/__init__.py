"""Event time: batches of many sources in, instants in time order up to the watermark out."""
