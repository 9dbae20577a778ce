"""Certificates and access: a folder of certificates -> who may do what at a router.

`grants` says what a certificate allows, `authority` issues certificates and checks them, `access` turns
grants into Zenoh's access control and limits.
"""
