/* The pixel loops of recon/ops/rasterize/cpu.py in C, for benchmarks/rasterize.py to compare with. */
#include <math.h>

enum { XC, YC, L11, L21, L22, E1, E2, E3, E4, E5, AMPLITUDE, ROW_0, ROW_1, SIZE };

static inline float exp_negative(float x) {
    float t = x * (1 / 16.f), p = t * (1 / 720.f) + 1 / 120.f;
    p = p * t + 1 / 24.f;
    p = p * t + 1 / 6.f;
    p = p * t + 0.5f;
    p = p * t + 1;
    p = p * t + 1;
    p *= p;
    p *= p;
    p *= p;
    return p * p;
}

static inline void row_span(const float *p, float dy, float k2, int columns, int *low, int *high) {
    float a = p[L11] * p[L11] - k2 * p[E3];
    float b = p[L11] * p[L21] * dy - 0.5f * k2 * (p[E1] + p[E4] * dy);
    float c = (p[L21] * p[L21] + p[L22] * p[L22]) * dy * dy - k2 * (1 + dy * (p[E2] + dy * p[E5]));
    *low = 0;
    *high = columns;
    if (a <= 0) return;
    float inside = b * b - a * c;
    if (inside < 0) {
        *high = 0;
        return;
    }
    float half = sqrtf(inside);
    *low = (int)ceilf(fminf(fmaxf(p[XC] - (b + half) / a, 0), columns));
    *high = (int)floorf(fminf(fmaxf(p[XC] + (half - b) / a, -1), columns - 1)) + 1;
}

void forward(const float *table, const float *restrict weights, const float *restrict lengths, float *restrict image,
             float k2, int count, int rows, int columns, int stride) {
    for (int g = 0; g < count; g++) {
        const float *p = table + SIZE * g, *w = weights + BASES * g;
        for (int r = p[ROW_0]; r < (int)p[ROW_1]; r++) {
            float dy = r - p[YC], shear = p[L21] * dy, across = p[L22] * dy;
            float flat = 1 + dy * (p[E2] + dy * p[E5]), tilt = p[E1] + p[E4] * dy;
            int low, high;
            row_span(p, dy, k2, columns, &low, &high);
            for (int c = low; c < high; c++) {
                float x = c - p[XC], inverse = 1 / ((x * p[E3] + tilt) * x + flat), along = x * p[L11] + shear;
                float q = (along * along + across * across) * inverse;
                float value = sqrtf(inverse) * exp_negative(fminf(q, k2) * -0.5f) * p[AMPLITUDE];
                value = q < k2 ? value : 0;
                for (int m = 0; m < BASES; m++) image[(m * rows + r) * stride + c] += value * w[m];
            }
        }
    }
    for (int m = 0; m < BASES; m++)
        for (int r = 0; r < rows; r++)
            for (int c = 0; c < columns; c++) image[(m * rows + r) * stride + c] *= lengths[r * columns + c];
}

void backward(const float *table, const float *restrict weights, const float *restrict pull, float *restrict sums,
              float k2, int count, int rows, int columns, int stride) {
    for (int g = 0; g < count; g++) {
        const float *p = table + SIZE * g, *w = weights + BASES * g;
        float s[12] = {0}, to[BASES] = {0};
        for (int r = p[ROW_0]; r < (int)p[ROW_1]; r++) {
            float dy = r - p[YC], shear = p[L21] * dy, across = p[L22] * dy;
            float flat = 1 + dy * (p[E2] + dy * p[E5]), tilt = p[E1] + p[E4] * dy;
            int low, high;
            row_span(p, dy, k2, columns, &low, &high);
            for (int c = low; c < high; c++) {
                float x = c - p[XC], inverse = 1 / ((x * p[E3] + tilt) * x + flat), along = x * p[L11] + shear;
                float q = (along * along + across * across) * inverse, all = 0;
                float value = sqrtf(inverse) * exp_negative(fminf(q, k2) * -0.5f) * p[AMPLITUDE];
                value = q < k2 ? value : 0;
                for (int m = 0; m < BASES; m++) {
                    float incoming = pull[(m * rows + r) * stride + c];
                    all += incoming * w[m];
                    to[m] += incoming * value;
                }
                all *= value;
                float alpha = all * inverse * -0.5f, beta = alpha - alpha * q;
                s[0] += all;
                s[1] += alpha * x;
                s[2] += alpha * dy;
                s[3] += alpha * x * x;
                s[4] += alpha * x * dy;
                s[5] += alpha * dy * dy;
                s[6] += beta;
                s[7] += beta * x;
                s[8] += beta * dy;
                s[9] += beta * x * x;
                s[10] += beta * x * dy;
                s[11] += beta * dy * dy;
            }
        }
        for (int i = 0; i < 12; i++) sums[(12 + BASES) * g + i] = s[i];
        for (int m = 0; m < BASES; m++) sums[(12 + BASES) * g + 12 + m] = to[m];
    }
}
