/* Bytes as letters, digits and two signs: RFC 4648.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <string.h>

#include "core/base.h"

static const char base64_digits[2][65] = {
    [BASE64_PADDED] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/",
    [BASE64_URL] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_"};

size_t base64_room(size_t n)
{
    return (n + 2) / 3 * 4 + 1;
}

size_t base64_write(const void *bytes, size_t n, enum base64_form form, char *out)
{
    const uint8_t *b = bytes;
    const char *const digits = base64_digits[form], *const start = out;
    uint32_t bits = 0;
    unsigned n_bits = 0;
    for (size_t i = 0; i < n; i++) {
        bits = bits << 8 | b[i];
        for (n_bits += 8; n_bits >= 6; n_bits -= 6)
            *out++ = digits[bits >> (n_bits - 6) & 63];
    }
    if (n_bits)
        *out++ = digits[bits << (6 - n_bits) & 63];
    while (form == BASE64_PADDED && (out - start) % 4)
        *out++ = '=';
    *out = '\0';
    return (size_t)(out - start);
}

bool base64_read(const char *text, void *out, size_t n)
{
    uint8_t *to = out, *const end = to + n;
    uint32_t bits = 0;
    unsigned n_bits = 0;
    if (strlen(text) != (4 * n + 2) / 3)
        return false;
    for (; *text; text++) {
        const char *at = strchr(base64_digits[BASE64_URL], *text);
        if (!at)
            return false;
        bits = bits << 6 | (uint32_t)(at - base64_digits[BASE64_URL]);
        n_bits += 6;
        if (n_bits >= 8 && to < end) {
            n_bits -= 8;
            *to++ = (uint8_t)(bits >> n_bits);
        }
    }
    return true;
}
