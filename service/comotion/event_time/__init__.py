"""Event time: batches of many sources in; instants in time order, and ended sessions, out."""
