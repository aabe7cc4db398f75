//! Finite element models: beam tables and the generalised eigenproblem.
