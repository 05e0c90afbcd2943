"""Maps on disk or in object storage: documents, units, a lock, a log."""
