/* The calls of CubeMX that cube_loop.c makes. In a project of yours, i2c.h has them. */
#ifndef HAL_H
#define HAL_H

#include <stdint.h>

typedef enum { HAL_OK = 0, HAL_ERROR = 1 } HAL_StatusTypeDef;
typedef struct { int instance; } I2C_HandleTypeDef;

extern I2C_HandleTypeDef hi2c1;

HAL_StatusTypeDef HAL_I2C_Mem_Write(I2C_HandleTypeDef *port, uint16_t device, uint16_t address,
                                    uint16_t address_size, uint8_t *data, uint16_t size,
                                    uint32_t timeout_ms);
HAL_StatusTypeDef HAL_I2C_Mem_Read(I2C_HandleTypeDef *port, uint16_t device, uint16_t address,
                                   uint16_t address_size, uint8_t *data, uint16_t size,
                                   uint32_t timeout_ms);
void HAL_Delay(uint32_t ms);

#endif
