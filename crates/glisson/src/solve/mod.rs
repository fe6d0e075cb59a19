//! Assembly, sparse factorization and boundary conditions.
