"""Contacts: what touches, and the rules by which that is solved."""

from taichi_sim.contacts.base import ContactRule
from taichi_sim.contacts.gauss_seidel import GaussSeidel
from taichi_sim.contacts.jacobi import Jacobi, Sum

__all__ = ["CONTACT_RULES", "ContactRule"]

CONTACT_RULES = {kind.name: kind for kind in (ContactRule, GaussSeidel, Jacobi, Sum)}
