"""What every front shows of a snapshot, and how one runs in a process of its own; nothing here draws."""
