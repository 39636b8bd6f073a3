#pragma once

namespace mtled {

/// Memory [bytes] that this program may still take: what the machine has free, or what is left of a container's limit if
/// that is less; 0 when the system does not tell.
double free_memory();

}  // namespace mtled
