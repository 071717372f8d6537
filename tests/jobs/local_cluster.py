"""A Ray cluster in a process of its own: Ray forks, and a test process with JAX must not.

It prints its address, and obeys the lines ``add`` and ``remove``; it ends with its input.
"""

import sys

MEMORY = 10**8
"""Bytes of a node's object store."""


def serve() -> None:
    from ray.cluster_utils import Cluster

    head = {"num_cpus": 1, "include_dashboard": False, "object_store_memory": MEMORY}
    cluster, node = Cluster(initialize_head=True, head_node_args=head), None
    print(cluster.address, flush=True)
    for line in sys.stdin:
        if line.strip() == "add":
            node = cluster.add_node(num_cpus=1, object_store_memory=MEMORY)
        elif node is not None:
            cluster.remove_node(node, allow_graceful=False)
        print("done", flush=True)
    cluster.shutdown()


if __name__ == "__main__":
    serve()
