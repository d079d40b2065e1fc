"""SPH sums over lists of neighbours, and what positions pull from them; native loops for the CPU."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module, scalar_types
from dc_kernels._warp.sph.smoothing import BLOCK, LANES, TERMS, block_text
from dc_kernels.sph.sums import CHUNK, QUANTITIES

N_CHUNK = wp.constant(CHUNK)
_VALUE, _GRADIENT, _LAPLACIAN, _DIVERGENCE = (QUANTITIES[n] for n in ("value", "gradient", "laplacian", "divergence"))

# Runs over the queries first..last and their lists in blocks; ``add(q, vectors)`` sees one block, weighed by a term.
_LOOP = f"""
auto run = [&](int term, auto add) {{
    const S* X = (const S*)query.data;
    for (int q = first; q < last; ++q) {{
        const int64_t end = neighbor_start.data[q + 1];
        for (int64_t b = neighbor_start.data[q]; b < end; b += {BLOCK}) {{
            const int n = end - b < {BLOCK} ? (int)(end - b) : {BLOCK};
            const int vectors = gather(X + (size_t)q * dim, neighbor_index.data + b, n);
            weigh(kernel, term, n, vectors);
            add(q, vectors);
        }}
    }}
}};
const S* A = (const S*)value.data;
const int width = (int)value.shape[1], out_width = (int)out.shape[1];
S* O = (S*)out.data;
for (size_t i = (size_t)first * out_width; i < (size_t)last * out_width; ++i) O[i] = 0;
// column c of the values of eight neighbours
auto column = [&](int j, int c) {{
    const S* a = A + c;
    return V{{{", ".join(f"a[(size_t)at[j + {lane}] * width]" for lane in range(LANES))}}};
}};
const S* E[3] = {{e0, e1, e2}};
"""

_SUM = f"""
if (quantity == {_VALUE} || quantity == {_LAPLACIAN}) {{
    run(quantity == {_VALUE} ? {TERMS["w"]} : {TERMS["laplacian"]}, [&](int q, int vectors) {{
        for (int c = 0; c < width; ++c) {{
            V sum = zero;
            for (int j = 0; j < {LANES} * vectors; j += {LANES}) sum += *(V*)(s0 + j) * column(j, c);
            O[(size_t)q * out_width + c] += scale * total(sum);
        }}
    }});
}} else if (quantity == {_GRADIENT}) {{
    run({TERMS["f"]}, [&](int q, int vectors) {{
        for (int c = 0; c < width; ++c) {{
            V x = zero, y = zero, z = zero;
            for (int j = 0; j < {LANES} * vectors; j += {LANES}) {{
                const V a = *(V*)(s0 + j) * column(j, c);
                x += a * *(V*)(e0 + j);
                y += a * *(V*)(e1 + j);
                if (dim == 3) z += a * *(V*)(e2 + j);
            }}
            S* o = O + (size_t)q * out_width + c * dim;
            o[0] += scale * total(x);
            o[1] += scale * total(y);
            if (dim == 3) o[2] += scale * total(z);
        }}
    }});
}} else {{
    run({TERMS["f"]}, [&](int q, int vectors) {{
        for (int c = 0; c < out_width; ++c) {{
            V sum = zero;
            for (int j = 0; j < {LANES} * vectors; j += {LANES}) {{
                V a = zero;
                for (int k = 0; k < dim; ++k) a += *(const V*)(E[k] + j) * column(j, c * dim + k);
                sum += *(V*)(s0 + j) * a;
            }}
            O[(size_t)q * out_width + c] += scale * total(sum);
        }}
    }});
}}
"""

_PULL = f"""
const S* U = (const S*)query_value.data;
const int own = (int)query_value.shape[1];
if (quantity != {_GRADIENT}) {{
    run(quantity == {_VALUE} ? {TERMS["f"]} : {TERMS["laplacian_slope"]}, [&](int q, int vectors) {{
        const S* u = U + (size_t)q * own;
        V x[3] = {{zero, zero, zero}};
        for (int j = 0; j < {LANES} * vectors; j += {LANES}) {{
            V a = zero;
            for (int c = 0; c < width; ++c) a += u[c] * column(j, c);
            a *= *(V*)(s0 + j);
            for (int k = 0; k < dim; ++k) x[k] += a * *(const V*)(E[k] + j);
        }}
        for (int k = 0; k < dim; ++k) O[(size_t)q * dim + k] += scale * total(x[k]);
    }});
}} else {{
    // one side's values have a component for each axis: the queries', or, if swapped, the neighbours'
    const S signed_scale = swapped ? -scale : scale;
    const int channels = swapped ? own : width;
    run({TERMS["hessian"]}, [&](int q, int vectors) {{
        const S* u = U + (size_t)q * own;
        V x[3] = {{zero, zero, zero}};
        for (int j = 0; j < {LANES} * vectors; j += {LANES}) {{
            V s[3] = {{zero, zero, zero}}, along = zero;
            for (int c = 0; c < channels; ++c) {{
                if (swapped) {{
                    for (int k = 0; k < dim; ++k) s[k] += u[c] * column(j, c * dim + k);
                }} else {{
                    const V a = column(j, c);
                    for (int k = 0; k < dim; ++k) s[k] += u[c * dim + k] * a;
                }}
            }}
            for (int k = 0; k < dim; ++k) along += *(const V*)(E[k] + j) * s[k];
            along *= *(V*)(s1 + j);
            for (int k = 0; k < dim; ++k) x[k] += *(V*)(s0 + j) * s[k] + along * *(const V*)(E[k] + j);
        }}
        for (int k = 0; k < dim; ++k) O[(size_t)q * dim + k] += signed_scale * total(x[k]);
    }});
}}
"""


def _snippet(dtype: str, body: str) -> str:
    return f"#if !defined(__CUDA_ARCH__)\n{block_text(dtype)}{_LOOP}{body}\n#endif\n"


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``sum_neighbors`` and ``pull_neighbors``; a thread takes CHUNK queries."""
    real = scalar_types(dtype).real
    module = kernel_module("sph", dtype)

    @wp.func_native(_snippet(dtype, _SUM))
    def sum_range(
        first: wp.int32,
        last: wp.int32,
        kernel: wp.int32,
        quantity: wp.int32,
        inv_h: real,
        scale: real,
        query: wp.array2d(dtype=real),
        neighbor_start: wp.array(dtype=wp.int64),
        neighbor_index: wp.array(dtype=wp.int32),
        point: wp.array2d(dtype=real),
        value: wp.array2d(dtype=real),
        out: wp.array2d(dtype=real),
    ): ...

    @wp.func_native(_snippet(dtype, _PULL))
    def pull_range(
        first: wp.int32,
        last: wp.int32,
        kernel: wp.int32,
        quantity: wp.int32,
        swapped: wp.int32,
        inv_h: real,
        scale: real,
        query: wp.array2d(dtype=real),
        neighbor_start: wp.array(dtype=wp.int64),
        neighbor_index: wp.array(dtype=wp.int32),
        point: wp.array2d(dtype=real),
        query_value: wp.array2d(dtype=real),
        value: wp.array2d(dtype=real),
        out: wp.array2d(dtype=real),
    ): ...

    @wp.kernel(module=module, enable_backward=False)
    def sum_neighbors(
        chunk_offset: int,
        kernel: int,
        quantity: int,
        h: real,
        scale: real,
        query: wp.array2d(dtype=real),
        neighbor_start: wp.array(dtype=wp.int64),
        neighbor_index: wp.array(dtype=wp.int32),
        point: wp.array2d(dtype=real),
        value: wp.array2d(dtype=real),
        # out:
        out: wp.array2d(dtype=real),
    ):
        """Seed, equations 3.7 and 3.8: out = sum of the neighbours' values times W, grad W, lap W, or . grad W."""
        first = (wp.tid() + chunk_offset) * N_CHUNK
        last = wp.min(first + N_CHUNK, query.shape[0])
        sum_range(
            first, last, kernel, quantity, real(1.0) / h, scale,
            query, neighbor_start, neighbor_index, point, value, out,
        )  # fmt: skip

    @wp.kernel(module=module, enable_backward=False)
    def pull_neighbors(
        chunk_offset: int,
        kernel: int,
        quantity: int,
        swapped: int,
        h: real,
        scale: real,
        query: wp.array2d(dtype=real),
        neighbor_start: wp.array(dtype=wp.int64),
        neighbor_index: wp.array(dtype=wp.int32),
        point: wp.array2d(dtype=real),
        query_value: wp.array2d(dtype=real),
        value: wp.array2d(dtype=real),
        # out:
        out: wp.array2d(dtype=real),
    ):
        """The gradient of sum(query_value . sum_neighbors(value)) by the queries' positions.

        Swapped, the queries are the particles of that sum and the neighbours its queries: by the particles' positions.
        """
        first = (wp.tid() + chunk_offset) * N_CHUNK
        last = wp.min(first + N_CHUNK, query.shape[0])
        pull_range(
            first, last, kernel, quantity, swapped, real(1.0) / h, scale,
            query, neighbor_start, neighbor_index, point, query_value, value, out,
        )  # fmt: skip

    return {"sum_neighbors": sum_neighbors, "pull_neighbors": pull_neighbors}
