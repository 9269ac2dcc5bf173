// Every function is put into its caller. Left to itself PoCL 3.0 calls the larger ones, once per box or triangle: the
// wide layouts took a third longer.
#define INLINED static inline __attribute__((always_inline))
