/* rt_compat.h: the compiler table. The only file that asks which compiler this is.
 *
 * The kernels are written in the language that OpenCL C 1.2, CUDA C++ (NVRTC) and C++17 share.
 * This header gives each of the three targets the same names:
 *
 *   RT_FN RT_KERNEL RT_GLOBAL RT_PRIVATE RT_RESTRICT RT_TABLE RT_GLOBAL_ID   qualifiers
 *   RT_VALUE(type) RT_UNIFORM                                               a kernel's parameter by value, where it is
 *   rt_u32 rt_i32 rt_u64 rt_i64                                             scalars of fixed width
 *   rt_float rt_int rt_uint rt_mask                                         one value a lane
 *   rt_splat* rt_sel rt_any rt_not rt_lane_ids RT_GATHER_*                  lane operations
 *   rt_store_* rt_load_*                                                    all lanes to memory and back
 *   rt_load_rows rt_mask_bits rt_lowest_bit                                 for one ray against RT_LANES things
 *   rt_seed_* rt_native_* rt_fast_*                                         what a device does its own way
 *   rt_vote_any rt_warp_* rt_add_shared                                     lanes of a warp together
 *
 * Lanes. With RT_LANES = 1 a lane type is a scalar and `if (rt_any(m))` is an ordinary branch. With
 * 4, 8 or 16 it is a vector and one work-item carries that many paths; a mask is then 0 or -1 a lane.
 * A scalar comparison yields 1 and a vector one -1, so masks are only ever combined with & and |,
 * negated with rt_not, tested with rt_any and used with rt_sel.
 *
 * Rules of the shared language: no overloads, templates, references, compound literals, recursion,
 * function pointers; `f` on every literal; no library mathematics but fma and (where proven) sqrt.
 */
#ifndef RT_COMPAT_H
#define RT_COMPAT_H

#if defined(__OPENCL_VERSION__) || defined(__OPENCL_C_VERSION__)
#define RT_TARGET_OPENCL 1
#elif defined(__CUDACC__)
#define RT_TARGET_CUDA 1
#else
#define RT_TARGET_HOST 1
#endif

/* Paths a work-item carries at once: 1, 4, 8 or 16. */
#ifndef RT_LANES
#define RT_LANES 1
#endif

/* Where rt_sqrt and rt_rcp come from (kernels/math.h): 1, the device's own operations, proven correctly
 * rounded by the self-test; 0, our fma sequences from a seed, which need no such proof. */
#ifndef RT_DEF_NATIVE_ROOTS
#define RT_DEF_NATIVE_ROOTS 1
#endif

/* 1 lets the compiler fuse products and sums. No kernel gives it anything to fuse (contract rule 3), which tests show
 * by setting it: OpenCL takes it from here, the other backends turn it into a compiler flag. */
#ifndef RT_DEF_CONTRACT
#define RT_DEF_CONTRACT 0
#endif

/* 1 where the OpenCL compiler takes inline PTX, which the backend finds out by trying. */
#ifndef RT_DEF_PTX
#define RT_DEF_PTX 0
#endif

/* 1 in programs whose every operation is noted (backends/traced_text.h): there all devices go the same way, in no warps
 * and without operations of their own. */
#ifndef RT_TRACED
#define RT_TRACED 0
#endif

/* The rung: which arithmetic the one source is compiled for (docs/contract.md, "Rungs").
 *   exact   float32 by the contract: the same bits on every device
 *   fast    float32 with what the device offers: no identity
 *   double  float64 by the same rules as exact, of the same packed scene; one lane */
#define RT_PRECISION_EXACT 0
#define RT_PRECISION_FAST 1
#define RT_PRECISION_DOUBLE 2
#ifndef RT_PRECISION
#define RT_PRECISION RT_PRECISION_EXACT
#endif

/* What the fast rung takes from the device. Each can be left out, which is how their errors are told apart. */
#define RT_FAST_ROOTS 0x1u       /* approximate square root, and 1 / sqrt in one operation */
#define RT_FAST_RECIPROCALS 0x2u /* approximate 1 / x */
#define RT_FAST_SINCOS 0x4u      /* the device's own sine and cosine */
#define RT_FAST_CONTRACT 0x8u    /* the compiler chooses where to fuse: no forced fma */
#define RT_FAST_FLUSH 0x10u      /* subnormals are flushed: the backends turn this into a flag, no macro can say it */
#define RT_FAST_ALL 0x1fu
#ifndef RT_DEF_FAST
#define RT_DEF_FAST RT_FAST_ALL
#endif
#define RT_FAST(part) (RT_PRECISION == RT_PRECISION_FAST && (RT_DEF_FAST & (part)) != 0u)

/* Our own roots exist to be exact in float32. */
#if RT_PRECISION != RT_PRECISION_EXACT
#undef RT_DEF_NATIVE_ROOTS
#define RT_DEF_NATIVE_ROOTS 1
#endif
#if RT_PRECISION == RT_PRECISION_DOUBLE && RT_LANES != 1
#error "rt: the double rung has one lane"
#endif

/* ---- qualifiers and scalars ------------------------------------------------------------------- */

#if defined(RT_TARGET_OPENCL)

#if RT_DEF_CONTRACT || RT_FAST(RT_FAST_CONTRACT)
#pragma OPENCL FP_CONTRACT ON
#else
#pragma OPENCL FP_CONTRACT OFF
#endif
#if RT_PRECISION == RT_PRECISION_DOUBLE
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
#endif
#define RT_FN static inline
#define RT_KERNEL(name) __kernel void name
#define RT_GLOBAL __global
#define RT_PRIVATE __private
#define RT_UNIFORM __private
#define RT_VALUE(type) const type
#define RT_RESTRICT restrict
#define RT_TABLE __constant
#define RT_GLOBAL_ID ((rt_u32)get_global_id(0))
#define RT_ALIGN_16 __attribute__((aligned(16)))
typedef uint rt_u32;
typedef int rt_i32;
typedef ulong rt_u64;
typedef long rt_i64;

#elif defined(RT_TARGET_CUDA)

#define RT_FN static __device__ __forceinline__
#define RT_KERNEL(name) extern "C" __global__ void name
#define RT_GLOBAL
#define RT_PRIVATE
#define RT_UNIFORM
#define RT_VALUE(type) const __grid_constant__ type
#define RT_RESTRICT __restrict__
#define RT_TABLE static __device__ const
#define RT_GLOBAL_ID (blockIdx.x * blockDim.x + threadIdx.x)
#define RT_ALIGN_16 __align__(16)
typedef unsigned int rt_u32;
typedef int rt_i32;
typedef unsigned long long rt_u64;
typedef long long rt_i64;

#else

#include <cmath>
#include <cstdint>
#include <cstring>
#define RT_FN [[maybe_unused]] static inline
/* A host kernel is called once a work-item; the caller sets the item's index for its thread. */
#define RT_KERNEL(name) [[maybe_unused]] static void name
#define RT_GLOBAL
#define RT_PRIVATE
#define RT_UNIFORM
#define RT_VALUE(type) const type
#define RT_RESTRICT __restrict__
#define RT_TABLE [[maybe_unused]] static const
#define RT_GLOBAL_ID rt_host_global_id
#define RT_ALIGN_16 alignas(16)
typedef std::uint32_t rt_u32;
typedef std::int32_t rt_i32;
typedef std::uint64_t rt_u64;
typedef std::int64_t rt_i64;
#if defined(__FAST_MATH__)
#error "rt: fast-math breaks the contract (docs/contract.md, rule 3); remove the flag"
#endif

#endif

/* The one static assertion that every target takes. `tag` makes the name unique. */
#define RT_STATIC_ASSERT(condition, tag) typedef char rt_static_assert_##tag[(condition) ? 1 : -1]

/* ---- one lane: scalars ------------------------------------------------------------------------- */

#if RT_LANES == 1

#if RT_PRECISION == RT_PRECISION_DOUBLE
typedef double rt_float;
#else
typedef float rt_float;
#endif
typedef rt_i32 rt_int;
typedef rt_u32 rt_uint;
typedef rt_i32 rt_mask;

#define rt_splat(x) (x)
#define rt_splat_i(x) ((rt_i32)(x))
#define rt_splat_u(x) ((rt_u32)(x))
#define RT_TRUE 1
#define RT_FALSE 0
#define rt_sel(mask, yes, no) ((mask) ? (yes) : (no))
#define rt_any(mask) ((mask) != 0)
#define rt_not(mask) (!(mask))
#define rt_lane_ids() 0u

#if RT_PRECISION == RT_PRECISION_DOUBLE
#if defined(RT_TARGET_OPENCL)
#define rt_fma(a, b, c) fma((double)(a), (double)(b), (double)(c))
#define rt_bits(x) as_ulong((double)(x))
#define rt_from_bits(x) as_double((ulong)(x))
#define rt_bits_one(x) as_uint(x)
#elif defined(RT_TARGET_CUDA)
#define rt_fma(a, b, c) __fma_rn((a), (b), (c))
#define rt_bits(x) ((rt_u64)__double_as_longlong(x))
#define rt_from_bits(x) __longlong_as_double((rt_i64)(x))
#define rt_bits_one(x) __float_as_uint(x)
#else
#define rt_fma(a, b, c) __builtin_fma((a), (b), (c))
RT_FN rt_u64 rt_bits(double x)
{
	rt_u64 bits;
	std::memcpy(&bits, &x, sizeof bits);
	return bits;
}
RT_FN double rt_from_bits(rt_u64 bits)
{
	double x;
	std::memcpy(&x, &bits, sizeof x);
	return x;
}
RT_FN rt_u32 rt_bits_one(float x)
{
	rt_u32 bits;
	std::memcpy(&bits, &x, sizeof bits);
	return bits;
}
#endif
#define rt_to_float(x) ((double)(x))
#define rt_to_int(x) ((rt_i32)(x))
#define rt_to_uint(x) ((rt_u32)(x))
#elif defined(RT_TARGET_OPENCL)
#define rt_fma(a, b, c) fma((float)(a), (float)(b), (float)(c))
#define rt_bits(x) as_uint((float)(x))
#define rt_from_bits(x) as_float((uint)(x))
#define rt_to_float(x) ((float)(x))
#define rt_to_int(x) ((int)(x))
#define rt_to_uint(x) ((uint)(x))
#elif defined(RT_TARGET_CUDA)
#define rt_fma(a, b, c) __fmaf_rn((a), (b), (c))
#define rt_bits(x) __float_as_uint(x)
#define rt_from_bits(x) __uint_as_float(x)
#define rt_to_float(x) ((float)(x))
#define rt_to_int(x) ((int)(x))
#define rt_to_uint(x) ((unsigned int)(x))
#else
#define rt_fma(a, b, c) __builtin_fmaf((a), (b), (c))
RT_FN rt_u32 rt_bits(float x)
{
	rt_u32 bits;
	std::memcpy(&bits, &x, sizeof bits);
	return bits;
}
RT_FN float rt_from_bits(rt_u32 bits)
{
	float x;
	std::memcpy(&x, &bits, sizeof x);
	return x;
}
#define rt_to_float(x) (static_cast<float>(x))
#define rt_to_int(x) (static_cast<rt_i32>(x))
#define rt_to_uint(x) (static_cast<rt_u32>(x))
#endif
#if RT_PRECISION != RT_PRECISION_DOUBLE
/* The bits of a float in memory, whatever the rung. */
#define rt_bits_one(x) rt_bits(x)
#endif

/* array[index] field, one element a lane: RT_GATHER_F(spheres, hit, .cx) for floats, RT_GATHER_U for rt_u32. `field`
 * may be empty. */
#define RT_GATHER_F(array, index, field) ((array)[index] field)
#define RT_GATHER_U(array, index, field) ((array)[index] field)
#define rt_store_u(x, pointer) (*(pointer) = (x))

/* ---- several lanes: vectors --------------------------------------------------------------------- */

#else

/* array[index] field of each lane, by its number in hexadecimal: RT_LANE(i, n) is a target's i.n. */
#define RT_AT(array, i, n, field) (array)[RT_LANE(i, n)] field
#define RT_4_LANES(array, i, a, b, c, d, field) \
	RT_AT(array, i, a, field), RT_AT(array, i, b, field), RT_AT(array, i, c, field), RT_AT(array, i, d, field)
#if RT_LANES == 4
#define RT_EACH_LANE(array, i, field) RT_4_LANES(array, i, 0, 1, 2, 3, field)
#define RT_LANE_NUMBERS 0u, 1u, 2u, 3u
#elif RT_LANES == 8
#define RT_EACH_LANE(array, i, field) RT_4_LANES(array, i, 0, 1, 2, 3, field), RT_4_LANES(array, i, 4, 5, 6, 7, field)
#define RT_LANE_NUMBERS 0u, 1u, 2u, 3u, 4u, 5u, 6u, 7u
#elif RT_LANES == 16
#define RT_EACH_LANE(array, i, field)                                                 \
	RT_4_LANES(array, i, 0, 1, 2, 3, field), RT_4_LANES(array, i, 4, 5, 6, 7, field), \
	    RT_4_LANES(array, i, 8, 9, a, b, field), RT_4_LANES(array, i, c, d, e, f, field)
#define RT_LANE_NUMBERS 0u, 1u, 2u, 3u, 4u, 5u, 6u, 7u, 8u, 9u, 10u, 11u, 12u, 13u, 14u, 15u
#else
#error "rt: RT_LANES must be 1, 4, 8 or 16"
#endif

#if defined(RT_TARGET_OPENCL)

#define RT_JOIN_(a, b) a##b
#define RT_JOIN(a, b) RT_JOIN_(a, b)
typedef RT_JOIN(float, RT_LANES) rt_float;
typedef RT_JOIN(int, RT_LANES) rt_int;
typedef RT_JOIN(uint, RT_LANES) rt_uint;
typedef RT_JOIN(int, RT_LANES) rt_mask;

#define rt_splat(x) ((rt_float)(x))
#define rt_splat_i(x) ((rt_int)(x))
#define rt_splat_u(x) ((rt_uint)(x))
#define RT_TRUE ((rt_mask)(-1))
#define RT_FALSE ((rt_mask)(0))
#define rt_sel(mask, yes, no) select((no), (yes), (mask))
#define rt_not(mask) (~(mask))
#define rt_fma(a, b, c) fma((rt_float)(a), (rt_float)(b), (rt_float)(c))
#define rt_bits(x) RT_JOIN(as_uint, RT_LANES)(x)
#define rt_from_bits(x) RT_JOIN(as_float, RT_LANES)(x)
#define rt_to_float(x) RT_JOIN(convert_float, RT_LANES)(x)
#define rt_to_int(x) RT_JOIN(convert_int, RT_LANES)(x)
#define rt_to_uint(x) RT_JOIN(convert_uint, RT_LANES)(x)

#define rt_store_u(x, pointer) RT_JOIN(vstore, RT_LANES)((x), 0, (pointer))
#define rt_store_f(x, pointer) RT_JOIN(vstore, RT_LANES)((x), 0, (pointer))
#define rt_load_u(pointer) RT_JOIN(vload, RT_LANES)(0, (pointer))
#define rt_load_f(pointer) RT_JOIN(vload, RT_LANES)(0, (pointer))
/* The i-th RT_LANES floats from a row on. Not by vload's own offset: a 32-bit product could wrap within a vector, and
 * PoCL then loads its halves one by one. */
#define rt_load_rows(row, i) RT_JOIN(vload, RT_LANES)(0, &((RT_GLOBAL const float*)(row))[RT_LANES * (i)])
#define rt_bits_one(x) as_uint(x)

#define RT_LANE(i, n) (i).s##n
#define rt_lane_ids() ((rt_uint)(RT_LANE_NUMBERS))

/* Bit k of rt_mask_bits() tells of lane k. OpenCL has no operation for that, x86 has: any() and folding take some six
 * and twelve instructions there, in the innermost loops. Only clang says what it has (PoCL). */
#if RT_LANES == 8 && defined(__clang__) && defined(__AVX__)
#define rt_mask_bits(mask) ((rt_u32)__builtin_ia32_movmskps256(as_float8(mask)))
#define rt_any(mask) (rt_mask_bits(mask) != 0u)
#elif RT_LANES == 4 && defined(__clang__) && defined(__SSE__)
#define rt_mask_bits(mask) ((rt_u32)__builtin_ia32_movmskps(as_float4(mask)))
#define rt_any(mask) (rt_mask_bits(mask) != 0u)
#else
/* any() looks at the top bit of each lane: right for our 0 and -1. */
#define rt_any(mask) any(mask)
/* Halves are laid over each other until one lane is left. */
#define RT_FOLD_LANES(x) ((x).lo | (x).hi)
RT_FN rt_u32 rt_mask_bits(rt_mask mask)
{
	rt_mask bits = mask & (rt_splat_i(1) << rt_to_int(rt_lane_ids()));
#if RT_LANES == 4
	return (rt_u32)RT_FOLD_LANES(RT_FOLD_LANES(bits));
#elif RT_LANES == 8
	return (rt_u32)RT_FOLD_LANES(RT_FOLD_LANES(RT_FOLD_LANES(bits)));
#else
	return (rt_u32)RT_FOLD_LANES(RT_FOLD_LANES(RT_FOLD_LANES(RT_FOLD_LANES(bits))));
#endif
}
#endif
/* The number of the lowest bit that is set in x, x not 0. */
#ifdef __clang__
#define rt_lowest_bit(x) ((rt_u32)__builtin_ctz(x))
#else
#define rt_lowest_bit(x) ((rt_u32)popcount(((x) & (0u - (x))) - 1u))
#endif
#define RT_GATHER_F(array, index, field) ((rt_float)(RT_EACH_LANE(array, index, field)))
#define RT_GATHER_U(array, index, field) ((rt_uint)(RT_EACH_LANE(array, index, field)))

#elif defined(RT_TARGET_HOST)

/* GCC's and clang's vector types: arithmetic, comparisons, shifts and ?: go lane by lane, on any number of lanes; the
 * compiler cuts what is wider than a register. What it has no operator for is written for one register of the target,
 * and done part by part. */
typedef float rt_float __attribute__((vector_size(4 * RT_LANES)));
typedef rt_i32 rt_int __attribute__((vector_size(4 * RT_LANES)));
typedef rt_u32 rt_uint __attribute__((vector_size(4 * RT_LANES)));
typedef rt_int rt_mask;

#if defined(__FMA__)
#include <immintrin.h>
#endif
#if defined(__AVX512F__) && RT_LANES == 16
typedef __m512 rt_register;
#define rt_register_fma(a, b, c) _mm512_fmadd_ps((a), (b), (c))
#define rt_register_sqrt(x) _mm512_maskz_sqrt_ps(0xffffu, (x)) /* the plain one warns under g++ 12 */
#define rt_register_bits(x) _mm512_test_epi32_mask(_mm512_castps_si512(x), _mm512_castps_si512(x))
#elif defined(__FMA__) && RT_LANES >= 8
typedef __m256 rt_register;
#define rt_register_fma(a, b, c) _mm256_fmadd_ps((a), (b), (c))
#define rt_register_sqrt(x) _mm256_sqrt_ps(x)
#define rt_register_bits(x) _mm256_movemask_ps(x)
#elif defined(__FMA__)
typedef __m128 rt_register;
#define rt_register_fma(a, b, c) _mm_fmadd_ps((a), (b), (c))
#define rt_register_sqrt(x) _mm_sqrt_ps(x)
#define rt_register_bits(x) _mm_movemask_ps(x)
#else
typedef float rt_register;
#define rt_register_fma(a, b, c) __builtin_fmaf((a), (b), (c))
#define rt_register_sqrt(x) __builtin_sqrtf(x)
#define rt_register_bits(x) (__builtin_signbit(x) != 0)
#endif

#define RT_REGISTERS (sizeof(rt_float) / sizeof(rt_register))
typedef struct rt_registers {
	rt_register part[RT_REGISTERS];
} rt_registers;
RT_FN rt_registers rt_to_registers(rt_float x)
{
	rt_registers r;
	std::memcpy(&r, &x, sizeof r);
	return r;
}
RT_FN rt_float rt_from_registers(rt_registers r)
{
	rt_float x;
	std::memcpy(&x, &r, sizeof x);
	return x;
}
RT_FN rt_float rt_fma(rt_float a, rt_float b, rt_float c)
{
	rt_registers x = rt_to_registers(a), y = rt_to_registers(b), z = rt_to_registers(c);
	for (unsigned i = 0; i < RT_REGISTERS; ++i)
		z.part[i] = rt_register_fma(x.part[i], y.part[i], z.part[i]);
	return rt_from_registers(z);
}
RT_FN rt_float rt_native_sqrt(rt_float x)
{
	rt_registers r = rt_to_registers(x);
	for (unsigned i = 0; i < RT_REGISTERS; ++i)
		r.part[i] = rt_register_sqrt(r.part[i]);
	return rt_from_registers(r);
}
/* Bit k tells of lane k of a mask. */
RT_FN rt_u32 rt_mask_bits(rt_mask mask)
{
	rt_registers r = rt_to_registers((rt_float)mask);
	rt_u32 bits = 0u;
	for (unsigned i = 0; i < RT_REGISTERS; ++i)
		bits |= static_cast<rt_u32>(rt_register_bits(r.part[i])) << (i * (RT_LANES / RT_REGISTERS));
	return bits;
}
#define rt_any(mask) (rt_mask_bits(mask) != 0u)
/* The number of the lowest bit that is set in x, x not 0. */
#define rt_lowest_bit(x) (static_cast<rt_u32>(__builtin_ctz(x)))

/* x - 0 and not x + 0, which would lose the sign of -0. */
RT_FN rt_float rt_splat(float x) { return x - rt_float{}; }
RT_FN rt_int rt_splat_i(rt_i32 x) { return x - rt_int{}; }
RT_FN rt_uint rt_splat_u(rt_u32 x) { return x - rt_uint{}; }
#define RT_TRUE rt_splat_i(-1)
#define RT_FALSE rt_splat_i(0)
#define rt_sel(mask, yes, no) ((mask) ? (yes) : (no))
#define rt_not(mask) (~(mask))
#define rt_bits(x) ((rt_uint)(x))
#define rt_from_bits(x) ((rt_float)(x))
#define rt_to_float(x) __builtin_convertvector((x), rt_float)
#define rt_to_int(x) __builtin_convertvector((x), rt_int)
#define rt_to_uint(x) __builtin_convertvector((x), rt_uint)

RT_FN void rt_store_u(rt_uint x, rt_u32* pointer) { std::memcpy(pointer, &x, sizeof x); }
RT_FN void rt_store_f(rt_float x, float* pointer) { std::memcpy(pointer, &x, sizeof x); }
RT_FN rt_uint rt_load_u(const rt_u32* pointer)
{
	rt_uint x;
	std::memcpy(&x, pointer, sizeof x);
	return x;
}
RT_FN rt_float rt_load_f(const float* pointer)
{
	rt_float x;
	std::memcpy(&x, pointer, sizeof x);
	return x;
}
/* The i-th RT_LANES floats from a row on */
#define rt_load_rows(row, i) rt_load_f(&((const float*)(row))[RT_LANES * (i)])
RT_FN rt_u32 rt_bits_one(float x)
{
	rt_u32 bits;
	std::memcpy(&bits, &x, sizeof bits);
	return bits;
}

#define RT_LANE(i, n) (i)[0x##n]
RT_FN rt_uint rt_lane_ids() { return rt_uint{RT_LANE_NUMBERS}; }
#define RT_GATHER_F(array, index, field) (rt_float{RT_EACH_LANE(array, index, field)})
#define RT_GATHER_U(array, index, field) (rt_uint{RT_EACH_LANE(array, index, field)})

#else
#error "rt: with CUDA RT_LANES must be 1: a warp's lanes are its threads"
#endif

#endif

#if RT_LANES > 1
/* The lanes whose bits are set. */
RT_FN rt_mask rt_lane_mask(rt_u32 bits)
{
	return (rt_splat_u(bits) & (rt_splat_u(1u) << rt_lane_ids())) != rt_splat_u(0u);
}
#endif

/* ---- bits of a float of the rung ------------------------------------------------------------------- */
#if RT_PRECISION == RT_PRECISION_DOUBLE
#define RT_SIGN_BIT ((rt_u64)1 << 63)
#define rt_low_word(x) ((rt_u32)rt_bits(x))
#define rt_sign_bit(x) ((rt_u32)(rt_bits(x) >> 63))
#else
#define RT_SIGN_BIT 0x80000000u
#define rt_low_word(x) rt_bits(x)
#define rt_sign_bit(x) (rt_bits(x) >> 31)
#endif

/* ---- the fast rung's multiply and add: the compiler may fuse it, and need not -------------------------- */
#if RT_FAST(RT_FAST_CONTRACT)
#undef rt_fma
#define rt_fma(a, b, c) ((a) * (b) + (c)) /* bare: the fast rung promises no bits */
#endif

/* ---- seeds for our own square root and reciprocal ------------------------------------------------
 * An approximation of 1/sqrt(x) or 1/x, right to a few ulp, from hardware where there is some. kernels/math.h finishes
 * it; the result does not depend on which seed was used (contract rule 2). */
#if defined(RT_TARGET_CUDA) || (defined(RT_TARGET_OPENCL) && RT_DEF_PTX)
#define RT_HARDWARE_SEEDS 1
RT_FN float rt_seed_rsqrt(float x)
{
	float y;
#if defined(RT_TARGET_CUDA)
	asm("rsqrt.approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(x));
#else
	__asm("rsqrt.approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(x));
#endif
	return y;
}
RT_FN float rt_seed_rcp(float x)
{
	float y;
#if defined(RT_TARGET_CUDA)
	asm("rcp.approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(x));
#else
	__asm("rcp.approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(x));
#endif
	return y;
}
#else
#define RT_HARDWARE_SEEDS 0
#endif

/* ---- the device's own square root and quotient ----------------------------------------------------
 * Exact: used only where the self-test proves them. NVIDIA's are its approximations and one step, as its own compiler
 * has them, without the branch for subnormals. Double: correctly rounded by IEEE 754 and by OpenCL's rules for fp64.
 * Fast: whatever is quickest. */
#if RT_PRECISION == RT_PRECISION_DOUBLE
#if defined(RT_TARGET_CUDA)
#define rt_native_sqrt(x) __dsqrt_rn(x)
#define rt_native_rcp(x) __drcp_rn(x)
#elif defined(RT_TARGET_OPENCL)
#define rt_native_sqrt(x) sqrt(x)
#define rt_native_rcp(x) (1.0f / (x))
#else
#define rt_native_sqrt(x) __builtin_sqrt(x)
#define rt_native_rcp(x) (1.0f / (x))
#endif
#else
#if RT_FAST(RT_FAST_ROOTS)
#if defined(RT_TARGET_CUDA)
RT_FN float rt_native_sqrt(float x)
{
	float y;
	asm("sqrt.approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(x));
	return y;
}
#define rt_fast_rsqrt(x) rt_seed_rsqrt(x)
#elif defined(RT_TARGET_OPENCL)
#define rt_native_sqrt(x) native_sqrt(x)
#define rt_fast_rsqrt(x) native_rsqrt(x)
#else
#define rt_fast_rsqrt(x) (1.0f / rt_native_sqrt(x))
#endif
#elif RT_HARDWARE_SEEDS
RT_FN float rt_native_sqrt(float x)
{
	float y = rt_seed_rsqrt(x);
	float root = x * y;
	return rt_fma(rt_fma(-root, root, x), 0.5f * y, root);
}
#elif defined(RT_TARGET_OPENCL)
#define rt_native_sqrt(x) sqrt(x)
#endif
#if defined(RT_TARGET_HOST) && RT_LANES == 1 /* several lanes: above */
#define rt_native_sqrt(x) __builtin_sqrtf(x)
#endif
#if RT_FAST(RT_FAST_RECIPROCALS) && defined(RT_TARGET_CUDA)
#define rt_native_rcp(x) rt_seed_rcp(x)
#elif RT_FAST(RT_FAST_RECIPROCALS) && defined(RT_TARGET_OPENCL)
#define rt_native_rcp(x) native_recip(x)
#elif RT_HARDWARE_SEEDS
RT_FN float rt_native_rcp(float x)
{
	float y = rt_seed_rcp(x);
	return rt_fma(rt_fma(-x, y, 1.0f), y, y);
}
#else
#define rt_native_rcp(x) (1.0f / (x))
#endif
#endif

/* ---- the fast rung's sine and cosine, of radians in [-pi, pi]: where the device has them in hardware ------ */
#if RT_FAST(RT_FAST_SINCOS) && defined(RT_TARGET_CUDA)
#define RT_FAST_HAS_SINCOS 1
#define rt_fast_sin(x) __sinf(x)
#define rt_fast_cos(x) __cosf(x)
#elif RT_FAST(RT_FAST_SINCOS) && defined(RT_TARGET_OPENCL)
#define RT_FAST_HAS_SINCOS 1
#define rt_fast_sin(x) native_sin(x)
#define rt_fast_cos(x) native_cos(x)
#else
#define RT_FAST_HAS_SINCOS 0
#endif

/* ---- the device's own minimum and maximum ---------------------------------------------------------
 * Of a number and NaN they are the number: other than rt_min and rt_max, so only for what cannot reach a pixel. */
#if RT_TRACED
#elif defined(RT_TARGET_CUDA) && RT_PRECISION == RT_PRECISION_DOUBLE
#define rt_native_min(a, b) fmin((a), (b))
#define rt_native_max(a, b) fmax((a), (b))
#elif defined(RT_TARGET_CUDA)
#define rt_native_min(a, b) fminf((a), (b))
#define rt_native_max(a, b) fmaxf((a), (b))
#elif defined(RT_TARGET_OPENCL) && RT_LANES == 1
#define rt_native_min(a, b) fmin((a), (b))
#define rt_native_max(a, b) fmax((a), (b))
#endif

/* ---- lanes of a warp ------------------------------------------------------------------------------
 * With one lane a work-item, NVIDIA's work-items run in warps of RT_WARP, and may ask what the others of theirs do.
 * It cannot change a result: only who does which work, and when. Elsewhere a work-item is a warp of its own.
 *
 * rt_vote_any: is it so for any lane? At the head of the path loop: without a vote there NVIDIA's compiler splits the
 * loop, and the lanes of a warp never meet again.
 *
 * rt_warp_ballot: bit k tells whether it is so for lane k. To be asked by all lanes together.
 *
 * rt_warp_here: the lanes that are at this very place.
 *
 * rt_warp_count, rt_warp_rank: how many bits are set; how many of them below a lane's.
 *
 * rt_add_shared, where RT_WARP > 1: adds to a sum that several lanes may add to at the same time. */
#if RT_LANES == 1 && defined(RT_TARGET_CUDA) && !RT_TRACED
#define RT_WARP 32u
#define rt_vote_any(mask) __any_sync(0xffffffffu, (mask))
#define rt_warp_ballot(mask) __ballot_sync(0xffffffffu, (mask))
#define rt_warp_here() __activemask()
#define rt_warp_count(bits) ((rt_u32)__popc(bits))
#define rt_add_shared(sum, x) ((void)atomicAdd((rt_u64*)(sum), (rt_u64)(x)))
#elif RT_LANES == 1 && defined(RT_TARGET_OPENCL) && RT_DEF_PTX && !RT_TRACED
#define RT_WARP 32u
RT_FN int rt_vote_any(int mask)
{
	int any_lane;
	__asm volatile("{ .reg .pred p; setp.ne.s32 p, %1, 0; vote.sync.any.pred p, p, 0xffffffff; selp.s32 %0, 1, 0, p; }"
	               : "=r"(any_lane)
	               : "r"(mask));
	return any_lane;
}
RT_FN rt_u32 rt_warp_ballot(int mask)
{
	rt_u32 bits;
	__asm volatile("{ .reg .pred p; setp.ne.s32 p, %1, 0; vote.sync.ballot.b32 %0, p, 0xffffffff; }"
	               : "=r"(bits)
	               : "r"(mask));
	return bits;
}
RT_FN rt_u32 rt_warp_here(void)
{
	rt_u32 bits;
	__asm volatile("activemask.b32 %0;" : "=r"(bits));
	return bits;
}
#define rt_warp_count(bits) ((rt_u32)popcount(bits))
RT_FN void rt_add_shared(__global rt_i64* sum, rt_i64 x)
{
	__asm volatile("red.global.add.u64 [%0], %1;" : : "l"((rt_u64)sum), "l"(x) : "memory");
}
#else
#define RT_WARP 1u
#define rt_vote_any(mask) rt_any(mask)
#define rt_warp_ballot(mask) ((mask) ? 1u : 0u)
#define rt_warp_here() 1u
#define rt_warp_count(bits) (bits)
#endif
#define rt_warp_rank(bits, lane) rt_warp_count((bits) & ((1u << (lane)) - 1u))

/* An ordinary branch for one lane, an unconditional block for several (which mask with rt_sel instead). */
#if RT_LANES == 1
#define RT_IF_ONE_LANE(mask) if (mask)
#else
#define RT_IF_ONE_LANE(mask)
#endif

#endif
