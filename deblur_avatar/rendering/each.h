// One source for the CPU and a GPU: what is done for each of many things, and sums over them.
//
// Compiled by nvcc, `each` and `each_sum` are kernels on a stream; elsewhere they are loops that
// threads share. What a `DO` lambda captures, it captures by value: pointers are of the place.

#pragma once

#include <cstdint>

#ifdef __CUDACC__

#include <cuda_runtime.h>

#define FORMULA __host__ __device__ inline
#define DO [=] __device__

typedef cudaStream_t Place;

constexpr int THREADS = 256, WARP = 32;

template <class F>
__global__ void run_each(int64_t count, F f) {
    const int64_t i = blockIdx.x * static_cast<int64_t>(THREADS) + threadIdx.x;
    if (i < count) f(i);
}

template <class F>
void each(int64_t count, Place stream, F f) {
    if (count > 0) run_each<<<(count + THREADS - 1) / THREADS, THREADS, 0, stream>>>(count, f);
}

template <int K, class F>
__global__ void run_each_sum(int64_t count, double *sums, F f) {
    const int64_t i = blockIdx.x * static_cast<int64_t>(THREADS) + threadIdx.x;
    double own[K] = {};
    if (i < count) f(i, own);
    __shared__ double of_warps[K][THREADS / WARP];
    for (int k = 0; k < K; ++k) {
        for (int off = WARP / 2; off > 0; off /= 2) own[k] += __shfl_down_sync(~0u, own[k], off);
        if (threadIdx.x % WARP == 0) of_warps[k][threadIdx.x / WARP] = own[k];
    }
    __syncthreads();
    if (threadIdx.x < K) {
        double total = 0;
        for (const double part : of_warps[threadIdx.x]) total += part;
        atomicAdd(sums + threadIdx.x, total);
    }
}

// f(i, own) adds to `own`, K numbers that begin at 0; all of them are added to `sums`.
template <int K, class F>
void each_sum(int64_t count, Place stream, double *sums, F f) {
    if (count > 0)
        run_each_sum<K><<<(count + THREADS - 1) / THREADS, THREADS, 0, stream>>>(count, sums, f);
}

__device__ inline void add_whole(int32_t *to, int32_t number) { atomicAdd(to, number); }

// What went wrong with what was asked of the GPU since this was last called; null if nothing did.
extern "C" const char *launch_problem() {
    const cudaError_t error = cudaGetLastError();
    return error == cudaSuccess ? nullptr : cudaGetErrorString(error);
}

#else

#define FORMULA inline
#define DO [=]

typedef int Place;  // threads

template <class F>
void each(int64_t count, Place threads, F f) {
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int64_t i = 0; i < count; ++i) f(i);
}

template <int K, class F>
void each_sum(int64_t count, Place, double *sums, F f) {
    for (int64_t i = 0; i < count; ++i) f(i, sums);
}

inline void add_whole(int32_t *to, int32_t number) {
#pragma omp atomic
    *to += number;
}

#endif
