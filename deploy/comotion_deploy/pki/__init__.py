"""Certificates, and who may do what at a router by them.

`certificates` says what a certificate allows, `authority` issues certificates and checks them, `access` turns
grants into Zenoh's access control and limits.
"""
