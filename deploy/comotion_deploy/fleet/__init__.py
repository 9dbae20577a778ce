"""Many scenes over many hosts: entries in etcd, and one agent a host that runs its share of them."""
