// Every function is inlined into its caller. PoCL 3.0 by itself calls the larger ones, once per box or triangle, which
// takes a third longer in the wide layouts.
//
// PORTABLE, if defined, excludes the built-in functions of compilers, and leaves functions as they are: Oclgrind stops
// at the markers that inlining leaves behind.
#if defined(PORTABLE)
#define INLINED static
#else
#define INLINED static inline __attribute__((always_inline))
#endif
