// Every function is inlined into its caller. PoCL 3.0 by itself calls the larger ones, once per box or triangle, which
// takes a third longer in the wide layouts.
#define INLINED static inline __attribute__((always_inline))
