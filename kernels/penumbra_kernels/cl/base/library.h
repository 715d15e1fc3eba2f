// The functions of OpenCL C's library that programs call, for a compiler that is spared its own declarations of all of them
// (PENUMBRA_BARE): 18,000 lines, which take longer to read than all of ours. With the attributes that clang's header gives them, so
// that the code is the same. What is missing here does not compile.
#define PENUMBRA_LIBRARY __attribute__((overloadable)) __attribute__((const))

size_t PENUMBRA_LIBRARY get_global_id(uint dimension);
int PENUMBRA_LIBRARY signbit(float x);
int8 PENUMBRA_LIBRARY convert_int8(float8 x);
float8 PENUMBRA_LIBRARY convert_float8(int8 x);
