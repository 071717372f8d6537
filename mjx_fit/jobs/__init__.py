"""Work in parts that depend on nothing but their piece: done in this process, or by workers on a cluster."""
