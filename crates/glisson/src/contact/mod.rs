//! Contact between tools and organs.
