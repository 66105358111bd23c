// Asks a map in single precision, compiled in as NAME: places, currents, moments from stdin, answers to stdout. With
// COUNT numbers are objects that count what is done to them.
// No library of templates: to compile one takes four times as long as all of this.
#include <cstdio>

#ifdef COUNT
struct counted {
    float value;
    static long sums, products, quotients;
    counted() = default;
    constexpr counted(float x) : value(x) {}
    explicit constexpr counted(double x) : value(float(x)) {}
    explicit counted(int x) : value(float(x)) {}
    explicit operator int() const { return int(value); }
    counted operator-() const { return counted(-value); }
    counted &operator+=(counted b) { sums++; value += b.value; return *this; }
    counted &operator*=(counted b) { products++; value *= b.value; return *this; }
};
long counted::sums = 0, counted::products = 0, counted::quotients = 0;
static inline counted operator+(counted a, counted b) { counted::sums++; return counted(a.value + b.value); }
static inline counted operator-(counted a, counted b) { counted::sums++; return counted(a.value - b.value); }
static inline counted operator*(counted a, counted b) { counted::products++; return counted(a.value * b.value); }
static inline counted operator/(counted a, counted b) { counted::quotients++; return counted(a.value / b.value); }
static inline bool operator<(counted a, counted b) { return a.value < b.value; }
static inline bool operator>(counted a, counted b) { return a.value > b.value; }
static inline bool operator<=(counted a, counted b) { return a.value <= b.value; }
static inline bool operator>=(counted a, counted b) { return a.value >= b.value; }
static inline bool operator==(counted a, counted b) { return a.value == b.value; }
#define FM32_REAL counted
#endif
#include MAP

int main()
{
    const int n = NAME.coils;
    const size_t size = size_t(n) + 6;
    float *row = new float[size];
    fm32_real *currents = new fm32_real[size];
    while (std::fread(row, sizeof(float), size, stdin) == size) {
        fm32_real point[3], moment[3], flux[3], gradient[9], wrench[6];
        for (int k = 0; k < n; k++) currents[k] = fm32_real(row[k]);
        for (int i = 0; i < 3; i++) point[i] = fm32_real(row[n + i]), moment[i] = fm32_real(row[n + 3 + i]);
#ifdef COUNT
        counted::sums = counted::products = counted::quotients = 0;
        fm32_field(&NAME, currents, point, flux, gradient);
        std::printf("%ld %ld %ld\n", counted::sums, counted::products, counted::quotients);
        (void)moment, (void)wrench;
    }
#else
        float out[19];
        out[18] = float(fm32_field(&NAME, n > 1 ? currents : NULL, point, flux, gradient));
        fm32_wrench(&NAME, n > 1 ? currents : NULL, point, moment, wrench);
        for (int i = 0; i < 3; i++) out[i] = flux[i];
        for (int i = 0; i < 9; i++) out[3 + i] = gradient[i];
        for (int i = 0; i < 6; i++) out[12 + i] = wrench[i];
        std::fwrite(out, sizeof(float), 19, stdout);
    }
#endif
    delete[] row;
    delete[] currents;
    return 0;
}
